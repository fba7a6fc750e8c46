"""Parameters of surfaces, light and rig: each declared once, with unit, default and range, without numpy."""
