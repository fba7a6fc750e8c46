"""Kinds of parts that can be inspected."""
