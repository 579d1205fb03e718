"""The command line: declarations, messages, exit codes. Nothing else prints."""
