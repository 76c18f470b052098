"""Operations on time series: filters, resampling, clocks, spectra."""
