"""Control by GPS: priors of the photographs, alignment to them, and their observations in the adjustment."""
