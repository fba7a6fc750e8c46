"""Registration of the part in every picture: by fiducial markers (``placement``) or by edges (``edges``)."""
