"""Structure from motion, control points and alignment to the building."""
