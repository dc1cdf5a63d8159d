"""Serialized Imu messages in and out, counts and health: what live and offline share."""
