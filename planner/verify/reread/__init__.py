"""The input read again by the verifier's own code: the print is measured against it, not against the toolpath."""
