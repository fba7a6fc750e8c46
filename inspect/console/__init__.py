"""The web console: one page at the station, one over all stations; a thin layer over what the commands call."""
