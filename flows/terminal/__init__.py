"""What the command line shows: bars while it works, tables and figures when it is done."""
