"""The line: jobs that a controller orders at a rig, and the protocols by which it does."""
