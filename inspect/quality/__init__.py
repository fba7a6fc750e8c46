"""Statistics for a quality department: control charts, capability, gauge studies, cameras."""
