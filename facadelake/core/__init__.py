"""What every package stands on: errors, frames, geodesy, cameras, tables, the cache. Each module is public."""
