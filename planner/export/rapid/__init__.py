"""RAPID for ABB controllers: writer, reader, and check against the plan."""
