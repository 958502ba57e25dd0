"""The virtual rig: a path-traced woven fabric before a simulated camera, and the scan of a draped cloth."""
