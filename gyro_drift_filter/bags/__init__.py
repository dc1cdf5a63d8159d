"""Bag in, bag out: Imu fields straight from their serialized form, reading and writing of bags."""
