"""Files that leave the house: tables for everybody, robot code only of verified plans."""
