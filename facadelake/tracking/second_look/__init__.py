"""A second look at the places of defects, in the photographs of campaigns that did not detect them."""
