"""The inverse problem: stepped surfaces that reflect light as wanted (Levin et al. 2013, sections 3 and 4)."""
