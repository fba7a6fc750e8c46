"""Fits: what measured brightness says of ridges and plastic, and what it cannot say."""
