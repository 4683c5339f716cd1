"""Order of parts. Search knows no geometry and no network: it gets a problem object and, for guidance, a callable."""
