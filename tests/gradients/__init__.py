"""Tests of the baking mathematics."""
