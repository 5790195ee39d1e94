# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # A vessel passes an array
#
# A ferry passes a recorder with four hydrophones. The recording is simulated (`scenarios/demo.toml`), so that the truth is
# known; a real one is read in the same way. From a file to a frame of tracks are four lines.

# %%
import seabearing as sb

written = sb.simulate("scenarios/demo.toml", "out/notebooks/pass")
run = sb.process(written["recording"], station=written["station"][0], levels=2)
tracks = run.frame("track")

# %%
columns = ["t_s", "stage", "cpa_range_m", "sd_cpa_range_m", "heading_deg", "sd_heading_deg", "speed_m_s"]
print(tracks[columns].tail(3).to_string(index=False, float_format="%.2f"))

# %% [markdown]
# What the recorder has said, in all:

# %%
print(run.counts)

# %% [markdown]
# ## Bearings beside the truth
#
# The truth is where the sound came from when it arrived. The band holds 95 % of what is stated.

# %%
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

truth = pd.read_csv(written["truth"][0])
bearings = run.frame("bearing")
true_deg = np.interp(
    bearings["t_s"], truth["t_s"], np.rad2deg(np.unwrap(np.deg2rad(truth["arrival_azimuth_deg"])))
)
error_deg = (bearings["azimuth_deg"] - true_deg + 180) % 360 - 180

fig, (above, below) = plt.subplots(2, 1, sharex=True, figsize=(8, 5), layout="constrained")
above.plot(truth["t_s"], truth["arrival_azimuth_deg"], color="black", lw=1, label="truth")
above.plot(bearings["t_s"], bearings["azimuth_deg"], ".", ms=3, color="tab:orange", label="recorder")
above.set(ylabel="azimuth (°)", ylim=(0, 360), yticks=range(0, 361, 90))
above.legend()
band_deg = 1.96 * bearings["sd_azimuth_deg"]
below.fill_between(bearings["t_s"], -band_deg, band_deg, color="tab:orange", alpha=0.3, lw=0, label="95 %")
below.plot(bearings["t_s"], error_deg, ".", ms=3, color="tab:blue", label="error")
below.set(xlabel="time (s)", ylabel="azimuth's error (°)", ylim=(-0.03, 0.03))
below.legend(loc="upper right")
fig.suptitle("Azimuth of the ferry")

inside = (error_deg.abs() <= band_deg).mean()
print(f"{len(bearings)} bearings, median error {error_deg.abs().median():.3f}°; {inside:.0%} in their 95 %")

# %% [markdown]
# ## The track
#
# The newest estimate of the ferry's closest point of approach, and how sure the recorder was of it as time went on.

# %%
fig, axis = plt.subplots(figsize=(8, 3), layout="constrained")
axis.errorbar(
    tracks["t_s"], tracks["cpa_range_m"], 1.96 * tracks["sd_cpa_range_m"], fmt=".", color="tab:orange", label="recorder, 95 %"
)
axis.axhline(truth["cpa_range_m"].iloc[0], color="black", lw=1, label="truth")
axis.set(xlabel="time (s)", ylabel="closest range (m)", ylim=(0, 1000), title="Closest point of approach")
axis.legend();

# %% [markdown]
# ## Spectra
#
# Levels are NumPy arrays. Without the hydrophones' sensitivities in the station file they are relative to full scale.

# %%
spectra = run.spectra()
fig, axis = plt.subplots(figsize=(8, 3), layout="constrained")
mesh = axis.pcolormesh(spectra.t_s, spectra.frequency_hz, spectra.density_db[:, 0].T, cmap="cividis", shading="nearest")
axis.set(yscale="log", xlabel="time (s)", ylabel="frequency (Hz)", title="Channel 0")
fig.colorbar(mesh, label=f"dB re ({spectra.reference[0]})² / Hz");
