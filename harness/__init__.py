"""What the demo, the benchmark and the tests share to run the package from outside."""
