"""The foundation of every package: errors, frames, geodesy, cameras, tables, the cache. Each module is public."""
