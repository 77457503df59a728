/PROG  TURNS
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "";
PROG_SIZE	= 900;
LINE_COUNT	= 5;
PROTECT		= READ_WRITE;
TCD:  STACK_SIZE	= 0,
      PAUSE_REQUEST	= 0;
DEFAULT_GROUP	= 1,*,*,*,*;
CONTROL_CODE	= 00000000 00000000;
/APPL
/MN
   1:J P[1] 100% FINE ;
   2:J P[2] 100% FINE ;
   3:J P[3] 100% FINE ;
   4:J P[4] 100% FINE ;
   5:J P[1] 100% FINE ;
/POS
P[1]{
   GP1:
	UF : 0, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =  -927.809  mm,	Y =   220.555  mm,	Z =   241.826  mm,
	W =  -165.757 deg,	P =     9.094 deg,	R =    -2.568 deg
};
P[2]{
   GP1:
	UF : 0, UT : 1,		CONFIG : 'F U T, 0, 1, -1',
	X =   966.955  mm,	Y =   151.320  mm,	Z =    93.203  mm,
	W =   175.899 deg,	P =    -1.391 deg,	R =    -7.449 deg
};
P[3]{
   GP1:
	UF : 0, UT : 1,		CONFIG : 'N U B, 0, 0, 0',
	X =  -194.618  mm,	Y =   163.082  mm,	Z =  1123.210  mm,
	W =   -52.728 deg,	P =   -72.003 deg,	R =   174.341 deg
};
P[4]{
   GP1:
	UF : 0, UT : 1,		CONFIG : 'N D T, 0, 0, 0',
	X =   438.389  mm,	Y =  -267.532  mm,	Z =  1231.594  mm,
	W =    74.209 deg,	P =   -59.541 deg,	R =    41.035 deg
};
/END
