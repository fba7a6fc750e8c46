"""Reflectance as data: models as functions of two directions, and the files of renderers and instruments."""
