"""Colour of spectra: CIE 1931 observer, illuminants, XYZ, sRGB, Lab and colour differences. No files of the user."""
