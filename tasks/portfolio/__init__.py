"""Tasks of the whole portfolio, beside the stages of an inspection."""
