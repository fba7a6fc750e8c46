"""HTML pages of inspections, calibrations, fits and studies."""
