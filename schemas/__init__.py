"""Every column once (name, type, unit, meaning, allowed values), the tables made of them, and the checks they imply."""
