"""Many rows on many cores: chunks, resume, clusters, the identity of a result, the settings of the compiler."""
