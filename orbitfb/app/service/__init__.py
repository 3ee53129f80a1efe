"""`orbitfb run`: everything that the service consists of, built, started, watched, stopped."""
