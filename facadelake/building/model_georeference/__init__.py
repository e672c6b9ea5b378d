"""model_georeference."""
