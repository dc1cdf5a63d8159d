"""Whether a recording can be trusted: arrays and reports in, findings out."""
