"""glTF's JSON and bytes as typed records and arrays, each checked once, where it is first read."""
