"""How a building model is georeferenced: map conversion, site coordinates, control pairs, graded by LoGeoRef level."""
