"""MCAP files: records, reader, writer, recovery. No rosbags, no filter."""
