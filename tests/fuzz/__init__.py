"""A short slice of the fuzzer's runs, and that its judges can find something."""
