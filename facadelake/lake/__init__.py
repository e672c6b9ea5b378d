"""DuckLake: connect, migrate, commit, read as of; the only importer of duckdb."""
