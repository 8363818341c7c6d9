"""Exporters: tables of any plan, robot code of verified ones only."""
