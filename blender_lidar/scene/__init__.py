"""From a scene file to a site: settings, sensor, chosen and held-out frames, and where vehicles count."""
