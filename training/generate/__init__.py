"""Generated pictures of defects with known boxes, drawn on real and synthetic surfaces."""
