"""The building: IFC elements, surface, georeference, rays, depth and virtual views."""
