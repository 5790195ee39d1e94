# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # A day at the ocean bottom
#
# A hydrophone and a seismometer at 4340 m hear three ships in a day. The day is simulated through a traced interference
# table. A real one is a folder of miniSEED with its StationXML.

# %%
from pathlib import Path

import seabearing as sb

out = Path("out/notebooks")
sb.propagation_table("scenarios/ocean-profile.csv", depth_m=4340, rows=720, out="out/ocean-table.toml")
day = out / "day.toml"
day.write_text('''
kind = "obs"
station = "../../scenarios/ocean-bottom-station.toml"
seed = 3
duration_s = 86400.0
start_utc = "2013-05-21T00:00:00Z"

[[vessels]]
straight = { cpa_time_s = 18000.0, cpa_range_m = 9000.0, heading_deg = 60.0, speed_m_s = 7.0, side = "port" }
[[vessels]]
straight = { cpa_time_s = 43200.0, cpa_range_m = 4000.0, heading_deg = 200.0, speed_m_s = 9.0, side = "starboard" }
[[vessels]]
straight = { cpa_time_s = 68400.0, cpa_range_m = 15000.0, heading_deg = 310.0, speed_m_s = 6.0, side = "port" }
''')
written = sb.simulate(day, out / "day")
print(*written["recording"], sep="\n")

# %% [markdown]
# ## From an ObsPy stream
#
# Files would do; a stream that has been cut, merged or fetched does as well.

# %%
import obspy

stream = obspy.Stream()
for path in written["recording"]:
    stream += obspy.read(path)
print(stream)
run = sb.process(stream, station=written["station"][0])
print(run.counts)

# %% [markdown]
# ## Ranges and azimuths beside the truth

# %%
import matplotlib.dates as mdates
import matplotlib.pyplot as plt
import pandas as pd

begun = pd.Timestamp("2013-05-21", tz="UTC")
truth = pd.read_csv(written["truth"][0])
truth["utc"] = begun + pd.to_timedelta(truth["t_s"], unit="s")
heard = truth[truth["heard_range_m"] < 45000]
ranges = run.frame("range").query("detected")
azimuths = run.frame("azimuth").dropna(subset=["azimuth_deg"])

fig, (above, below) = plt.subplots(2, 1, sharex=True, figsize=(8, 5), layout="constrained")
above.plot(ranges["utc"], ranges["range_m"] / 1e3, ".", ms=3, color="tab:orange", label="recorder")
above.set(ylabel="range (km)", ylim=(0, 45))
below.plot(azimuths["utc"], azimuths["azimuth_deg"], ".", ms=3, color="tab:orange", label="recorder")
below.set(ylabel="azimuth (°)", ylim=(0, 360), yticks=range(0, 361, 90), xlabel="2013-05-21, UTC")
for number, (_, ship) in enumerate(heard.groupby("source")):
    label = "truth" if number == 0 else None
    above.plot(ship["utc"], ship["heard_range_m"] / 1e3, color="black", lw=1, label=label)
    below.plot(ship["utc"], ship["heard_azimuth_deg"], ",", color="black", label=label)
below.xaxis.set_major_formatter(mdates.DateFormatter("%H"))
above.legend()
fig.suptitle("Three ships in a day");

# %% [markdown]
# ## Final tracks

# %%
tracks = run.frame("track")
final = tracks[tracks["stage"] == "final"].copy()
final["closest"] = begun + pd.to_timedelta(final["cpa_time_s"].round(), unit="s")
columns = ["closest", "sd_cpa_time_s", "cpa_range_m", "sd_cpa_range_m", "heading_deg", "sd_heading_deg", "speed_m_s"]
print(final[columns].to_string(index=False, float_format="%.2f"))

# %%
true = pd.read_csv(written["tracks"][0])
true["closest"] = begun + pd.to_timedelta(true["cpa_time_s"], unit="s")
print(true[["source", "closest", "cpa_range_m", "heading_deg", "speed_m_s"]].to_string(index=False))
