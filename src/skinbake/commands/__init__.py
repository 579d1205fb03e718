"""The work of each command: options in, result out. It joins the parts below and prints nothing."""
