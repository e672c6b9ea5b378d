"""Pictures of defects that nobody photographed: drawn on real and painted surfaces, with the boxes known."""
