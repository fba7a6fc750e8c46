"""The demo on the virtual rig."""
