"""[Benthin and Wald 2009], as published: `frusta`, `cornerrays`, `frustaleaf`, `packet256`; its tables: `measure`."""
