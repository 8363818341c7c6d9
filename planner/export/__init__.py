"""Exporters: tables of any plan, robot code only of verified plans."""
