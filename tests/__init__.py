"""Tests of skinbake; the folders mirror src/skinbake."""
