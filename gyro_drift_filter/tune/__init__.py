"""Settings that suit one robot better than the defaults, where there are any."""
