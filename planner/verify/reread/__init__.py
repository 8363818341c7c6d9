"""The input read again by the verifier's own code: what is printed is measured against it, not against the toolpath."""
