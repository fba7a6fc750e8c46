"""Studies of the method: detection, sensitivity, and its conditions."""
