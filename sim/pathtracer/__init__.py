"""Path tracing of height maps: renders what the reflectance models of `anisoscope.sim.light` then have to predict."""
