"""The systems that the field is compared with: one protocol, and one file for each."""
