"""Surface texture after ISO 25178-2: parameters, filters, spectra."""
