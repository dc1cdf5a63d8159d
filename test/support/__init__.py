"""What several tests need: messages, bags, a simulated sensor, the real node, long runs."""
