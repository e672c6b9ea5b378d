"""Published files: GeoParquet, GeoPackage, pictures."""
