"""Structure from motion, control points, georeference. pycolmap works in a process of its own (``pose/worker``)."""
