"""The names under which users see the filter, live and offline."""

NODE_NAME = 'gyro_drift_filter'
# The names of its statuses in diagnostics, behind the full one of the node.
INPUT, FILTER = ': input', ': filter'
