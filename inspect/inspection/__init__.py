"""One inspection from recipe to record, and many in a row."""
