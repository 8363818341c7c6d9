"""RAPID for ABB controllers: written, and read back."""
