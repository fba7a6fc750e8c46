"""Commands of the web console."""
