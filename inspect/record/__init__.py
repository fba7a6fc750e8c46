"""The record of an inspection: pure data, its JSON Schema, and the seal of the file."""
