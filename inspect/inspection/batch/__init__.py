"""Many parts in a row: trays that an operator or a robot fills, and folders of frames that arrive by themselves."""
