/PROG  REGISTERS
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "";
PROG_SIZE	= 900;
LINE_COUNT	= 17;
PROTECT		= READ_WRITE;
TCD:  STACK_SIZE	= 0,
      PAUSE_REQUEST	= 0;
DEFAULT_GROUP	= 1,*,*,*,*;
CONTROL_CODE	= 00000000 00000000;
/APPL
/MN
   1:J PR[1:home] 100% FINE ;
   2:L PR[2] 300mm/sec FINE ;
   3:  PR[2,3]=R[4]+50.5 ;
   4:L P[1] 100mm/sec FINE ;
   5:L P[2] 100mm/sec FINE Offset,PR[3:shift] ;
   6:L P[2] 100mm/sec FINE Tool_Offset,PR[4] ;
   7:L P[3] 100mm/sec FINE INC ;
   8:L P[1] 100mm/sec FINE VOFFSET,VR[1] ;
   9:L P[4] 50mm/sec FINE Skip,LBL[2] ;
  10:L P[R[5:index]] 100mm/sec FINE ;
  11:L P[5] 100mm/sec FINE ;
  12:  P[5]=PR[6] ;
  13:L PAL_1[A_1] 200mm/sec FINE ;
  14:L P[1] 20mm/sec CNT0 Search[Z],PR[7],PR[8] ;
  15:L P[6] 100mm/sec FINE Offset ;
  16:L PR[R[1]] 100mm/sec FINE Offset,PR[3:shift] ;
  17:J P[8] 100% FINE ;
/POS
P[1]{
   GP1:
	UF : 0, UT : 0,		CONFIG : 'N U T, 0, 0, 0',
	X =   880.083  mm,	Y =   125.106  mm,	Z =   453.848  mm,
	W =   156.348 deg,	P =    -1.933 deg,	R =    48.192 deg
};
P[2]{
   GP1:
	UF : 0, UT : 0,		CONFIG : 'N U T, 0, 0, 0',
	X =   905.406  mm,	Y =  -395.362  mm,	Z =   301.153  mm,
	W =  -176.716 deg,	P =   -14.358 deg,	R =    68.812 deg
};
P[3]{
   GP1:
	UF : 0, UT : 0,		CONFIG : 'N U T, 0, 0, 0',
	X =   621.609  mm,	Y =   357.978  mm,	Z =   577.110  mm,
	W =   159.954 deg,	P =   -35.303 deg,	R =   -13.117 deg
};
P[4]{
   GP1:
	UF : 0, UT : 0,		CONFIG : 'N U T, 0, 0, 0',
	X =  1066.908  mm,	Y =   128.833  mm,	Z =   154.368  mm,
	W =  -156.915 deg,	P =    -9.538 deg,	R =    -6.570 deg
};
P[5]{
   GP1:
	UF : 0, UT : 0,		CONFIG : 'N U T, 0, 0, 0',
	X =   662.016  mm,	Y =  -664.697  mm,	Z =   423.103  mm,
	W =  -123.833 deg,	P =    13.068 deg,	R =   136.711 deg
};
P[6]{
   GP1:
	UF : 0, UT : 0,		CONFIG : 'N U T, 0, 0, 0',
	X =   878.182  mm,	Y =   310.393  mm,	Z =   373.769  mm,
	W =   169.207 deg,	P =   -11.566 deg,	R =   -97.812 deg
};
P[7]{
   GP1:
	UF : 0, UT : 0,		CONFIG : 'N U T, 0, 0, 0',
	X =   905.406  mm,	Y =  -395.362  mm,	Z =   301.153  mm,
	W =  -176.716 deg,	P =   -14.358 deg,	R =    68.812 deg
};
/END
