"""What the commands do, for Python, pages and servers as well: one function for each."""
