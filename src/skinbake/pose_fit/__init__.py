"""α and β fitted to poses."""
