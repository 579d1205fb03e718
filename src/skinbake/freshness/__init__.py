"""Whether α and β in a file still fit its arrays."""
