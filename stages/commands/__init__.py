"""The commands of `gpf` that need the project around them."""
