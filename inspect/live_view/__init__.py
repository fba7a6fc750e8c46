"""What the camera sees now: numbers (``view``), a drawn picture (``picture``), a page that shows it (``page``)."""
