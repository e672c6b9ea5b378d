"""One module a stage: reads, calls the domain, writes, logs counts. No algorithm."""
