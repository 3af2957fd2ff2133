"""A lens database in lensfun's form, written for the tests: nothing in it is from anybody's measurements."""

MOUNTS = """
<mount><name>Alpha</name><compat>Screw</compat></mount>
<mount><name>Beta</name></mount>
"""
CAMERAS = """
<camera><maker>SONY</maker><model>ILCE-7RM2</model><mount>Alpha</mount><cropfactor>1</cropfactor></camera>
<camera><maker>Sony</maker><model>ILCE-6400</model><mount>Alpha</mount><cropfactor>1.53</cropfactor></camera>
<camera><maker>NIKON CORPORATION</maker><model>NIKON D810</model><mount>Beta</mount><cropfactor>1</cropfactor></camera>
<camera><maker>Acme</maker><model>Box 1</model><mount>Beta</mount><cropfactor>2.0</cropfactor></camera>
"""
ZOOM = """
<lens><maker>Acme</maker><model>Acme 20-40mm f/2.8</model><mount>Alpha</mount><cropfactor>1</cropfactor><calibration>
<distortion model="ptlens" focal="20" a="0.01" b="-0.05" c="0.01"/>
<distortion model="ptlens" focal="28" a="0.005" b="-0.02" c="0.004"/>
<distortion model="ptlens" focal="40" a="0.001" b="0.002" c="0.003"/>
<tca model="poly3" focal="20" vr="1.0004" vb="0.9997" br="0.0001" bb="-0.0001"/>
<tca model="poly3" focal="40" vr="1.0002" vb="0.9998"/>
<vignetting model="pa" focal="20" aperture="2.8" distance="1000" k1="-1.0" k2="0.5" k3="-0.2"/>
<vignetting model="pa" focal="40" aperture="2.8" distance="1000" k1="-0.6" k2="0.1" k3="0.0"/>
<vignetting model="pa" focal="20" aperture="8" distance="1000" k1="-0.4" k2="0.1" k3="0.0"/>
</calibration></lens>
"""
PRIME = """
<lens><maker>Acme</maker><model>Acme 50mm f/1.8</model><mount>Alpha</mount><cropfactor>{crop}</cropfactor><calibration>
<distortion model="poly3" focal="50" k1="{k1}"/>
</calibration></lens>
"""
OTHERS = """
<lens><maker>Acme</maker><model>Acme 35mm f/2</model><mount>Screw</mount><cropfactor>1.0</cropfactor><calibration>
<distortion model="poly5" focal="35" k1="0.01" k2="-0.002"/>
<tca model="linear" focal="35" kr="1.0003" kb="0.9996"/>
</calibration></lens>
<lens><maker>Acme</maker><model>Acme 8mm Fisheye</model><mount>Alpha</mount><type>fisheye</type>
<cropfactor>1</cropfactor></lens>
<lens><maker>Acme</maker><model>Acme 85mm</model><mount>Alpha</mount><cropfactor>1</cropfactor><calibration>
<distortion model="acm" focal="85" k1="0.01"/></calibration></lens>
"""


def text() -> str:
    primes = PRIME.format(crop=1.0, k1=-0.02) + PRIME.format(crop=1.53, k1=-0.05)
    return f'<lensdatabase version="1">{MOUNTS}{CAMERAS}{ZOOM}{primes}{OTHERS}</lensdatabase>'
