"""The systems that the field is compared with: one protocol, one module or package per system."""
