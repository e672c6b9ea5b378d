"""Read IFC models: meshes, spatial structure, materials and table ``elements``."""
