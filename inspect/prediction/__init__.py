"""Predictions of radiance and contrast, with their uncertainty."""
