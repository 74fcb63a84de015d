"""Parts that several verbs share: options, printing, errors, the REST client."""
