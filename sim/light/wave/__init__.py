"""Reflectance by wave optics (Levin et al. 2013): height maps, statistical surfaces, and when it is needed."""
