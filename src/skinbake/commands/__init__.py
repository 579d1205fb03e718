"""What each command does: options in, result out. Joins the parts below; prints nothing."""
