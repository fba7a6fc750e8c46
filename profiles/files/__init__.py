"""Files of height maps: readers, writers, checks."""
