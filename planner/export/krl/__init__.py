"""KUKA Robot Language for KR C controllers: written, and read back."""
