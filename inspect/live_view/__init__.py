"""Live picture of the camera: numbers (``view``), a drawn picture (``picture``), a page that shows it (``page``)."""
