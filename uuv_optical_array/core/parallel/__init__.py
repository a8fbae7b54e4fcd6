"""Work in chunks, by threads or a cluster, that lasts on a shared disk."""
