"""Height maps of surfaces: read, write, check, level, make ideal ones, spoil them."""
