"""Editing of height maps: a chain of steps, each written into the history of the map."""
