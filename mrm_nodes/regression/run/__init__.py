"""A run of many cases: processes, clusters, what is kept of it as it goes, and the cache."""
