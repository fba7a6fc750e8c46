"""Views of parameter models: as options of the command line."""
