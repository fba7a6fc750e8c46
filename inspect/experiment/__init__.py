"""The experiment with printed and moulded ridges of the ridge paper: contrasts over angles and tilts."""
