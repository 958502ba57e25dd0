"""The rig: a goniometer that speaks HID, real or simulated, and the interface of a camera."""
