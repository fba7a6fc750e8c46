"""Parts, benches and recipes of the demo, a folder for each kind of part."""
