"""Tests of correctives, and of stock viewers that play them."""
