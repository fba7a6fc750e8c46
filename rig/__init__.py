"""The rig: stages, cameras, the transport under them, and the acquisition sequence."""
