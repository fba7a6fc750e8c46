"""The figures and tables of the three papers, repeated."""
