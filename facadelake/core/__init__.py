"""What every room stands on: errors, frames, geodesy, cameras, tables between stages, the cache. Each module is public."""
