"""Results as text, JSON and JUnit XML; no arithmetic of its own."""
