"""Reading the source of Facadelake itself."""
