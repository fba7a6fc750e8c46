"""Studies of the method itself: what is found, how surely, and under which conditions."""
