"""The command `gyro_drift`: parsing of arguments and printing only."""
