"""The rig: a goniometer that speaks HID and a camera."""
