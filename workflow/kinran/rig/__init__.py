"""The rig: a goniometer that speaks HID, real or simulated, and what capture asks of a camera."""
